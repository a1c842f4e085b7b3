"""The logs of the page: where they are, what each holds, notes, and what was deleted."""
