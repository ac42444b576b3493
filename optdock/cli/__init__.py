"""The command line: `optdock plan | simulate | certify | compare | demo | plugins`.

Commands load the library when they run, so that `--help` stays quick.
"""

from optdock.cli.app import app, main

__all__ = ["app", "main"]
