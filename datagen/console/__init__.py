"""What the commands of all packages share: flags, messages, progress, Ctrl-C."""
