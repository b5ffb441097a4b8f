"""A user's own meshes: reading, units, textures, convex hulls for physics, and exact geometry for `verify`."""
