"""Run :func:`tools.attack.campaign.main`: multiprocessing finds no function in this module."""

import sys

from tools.attack.campaign import main

if __name__ == "__main__":
    sys.exit(main())
