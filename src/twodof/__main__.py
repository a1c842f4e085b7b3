"""`python -m twodof` is the command line `twodof`."""

from twodof.cli import main

if __name__ == "__main__":
    main()
