"""Layered layout of graphs, wire routing and text widths for pictures of diagrams."""
