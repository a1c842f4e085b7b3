"""`python -m twodof.cli`: the command line of this very Python."""

from twodof.cli import main

if __name__ == "__main__":
    main()
