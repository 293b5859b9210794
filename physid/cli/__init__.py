"""The command line: parse, call, print."""

from physid.cli.app import main

__all__ = ["main"]
