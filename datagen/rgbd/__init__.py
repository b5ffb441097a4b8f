"""RGB-D files of users: images, camera poses, and the world frame on the table that they show."""

OBJECTS = 16
"""Most objects on a user's table that are looked for, unless the user gives another number."""
