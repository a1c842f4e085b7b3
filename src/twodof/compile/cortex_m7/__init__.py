"""Cortex-M7 machine code on an emulated processor. See docs/explanation/targets.md."""
