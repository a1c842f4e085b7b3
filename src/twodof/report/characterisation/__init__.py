"""The paper's characterisation of a machine: from its flights to the content of the report."""
