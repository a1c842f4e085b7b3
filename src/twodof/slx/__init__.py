"""Simulink files without MATLAB: read .slx and .mdl, say what is in them, draw, compare and import them."""
