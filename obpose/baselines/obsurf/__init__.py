"""ObSuRF: object slots from one image, decoded to neural fields (Stelzner, Kersting and Kosiorek 2021)."""
