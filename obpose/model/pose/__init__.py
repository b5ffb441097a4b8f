"""Where the objects are, how they are turned, and what is encoded of them."""
