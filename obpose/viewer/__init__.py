"""A page to look at scenes and to edit them by hand: what `obpose-view` serves."""
