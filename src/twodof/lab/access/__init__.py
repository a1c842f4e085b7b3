"""Who may do what: tokens, roles, where a request comes from, and how large it may be."""

from twodof.lab.access.declared import computes, stops, takes

__all__ = ["computes", "stops", "takes"]
