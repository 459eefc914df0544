"""How the scripts report errors: one line, as the command line of twinlens does."""

import signal
import sys
from collections.abc import Callable

from twinlens.cli import INTERRUPTED
from twinlens.errors import MissingExtraError, TwinlensError, import_extra

try:
    for module in ("torch", "onnx", "onnxruntime"):
        import_extra(module, "train")
except MissingExtraError as error:
    print(error, file=sys.stderr)
    sys.exit(error.exit_code)


def run(main: Callable[[], None]) -> None:
    """Run a script. Exits with code 2 after bad input, and 130 after Ctrl-C or SIGTERM."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        main()
    except TwinlensError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        print("interrupted; the same command resumes", file=sys.stderr)
        sys.exit(INTERRUPTED)
