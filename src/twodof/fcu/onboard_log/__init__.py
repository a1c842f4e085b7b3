"""The log that is written on board, one row a control period."""
