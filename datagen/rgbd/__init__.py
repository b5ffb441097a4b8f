"""RGB-D files of users: images, camera poses, and the world frame on the table that they show."""
