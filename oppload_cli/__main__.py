"""``python -m oppload_cli``."""

from oppload_cli.cli import main

main()
