"""What is scored besides models of the registry."""
