"""`twinlens` and `python -m twinlens`: the command line."""

import sys

try:
    from twinlens.cli import console
except KeyboardInterrupt:
    print("twinlens: interrupted", file=sys.stderr)
    sys.exit(130)

if __name__ == "__main__":
    console()
