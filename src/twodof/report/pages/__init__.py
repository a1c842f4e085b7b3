"""HTML pages that stand alone: the report, the generated C."""
