"""Simulink files without MATLAB: read .slx and .mdl, say what is in them, draw them and compare two."""
