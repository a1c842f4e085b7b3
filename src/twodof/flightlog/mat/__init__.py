"""MATLAB v5 files, the format of the public logs of the real drone."""
