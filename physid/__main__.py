"""``python -m physid``: the command line."""

import sys

from physid.cli import main

if __name__ == "__main__":
    sys.exit(main())
