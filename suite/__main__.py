"""`python -m suite`: the command line without its installed script."""

from suite.cli import main

main()
