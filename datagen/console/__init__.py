"""Shared parts of all commands: command line, messages, progress, Ctrl-C."""
