"""Spectra of a record, the frequency responses they give, and transfer functions fitted to those."""
