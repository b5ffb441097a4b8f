"""Job execution: from a request to finished results."""
