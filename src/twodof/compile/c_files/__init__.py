"""A program as a C file and its header, for a firmware or any other program in C or C++."""
