"""The JSON form of diagrams: writing it, and reading it within limits."""

from twodof.blocks.schema.json_form import from_json, read_diagram, to_json

__all__ = ["from_json", "read_diagram", "to_json"]
