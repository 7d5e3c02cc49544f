"""``python -m multirod`` is the command ``multirod``."""

import sys

from multirod.cli import main

if __name__ == "__main__":
    sys.exit(main())
