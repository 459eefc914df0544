"""`python -m twinlens` is the command line."""

from twinlens.cli import console

if __name__ == "__main__":
    console()
