"""Runs the command line, for ``python -m kinefilter``."""

import sys

from kinefilter.pipeline.cli import main

if __name__ == "__main__":
    sys.exit(main())
