"""`python -m scenarios` is `appli`."""

from scenarios.cli import main

main()
