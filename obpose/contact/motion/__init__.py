"""Motion of objects through a clip: tracking, rigid motion of parts, and boxes from all frames."""
