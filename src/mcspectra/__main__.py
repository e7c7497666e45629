"""``python -m mcspectra``."""

import sys

from mcspectra.cli.main import main

sys.exit(main())
