"""ObPose: object-centric 3D scene models, and the data they learn from."""
