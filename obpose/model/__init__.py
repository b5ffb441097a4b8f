"""The ObPose model and its parts."""
