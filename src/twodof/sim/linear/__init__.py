"""The rig and the controllers in hover as linear models, and the margins of the loops that they make."""
