"""Light and table texture of a scene."""
