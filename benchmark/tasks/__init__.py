"""Tasks beside segmentation."""
