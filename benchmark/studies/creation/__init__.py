"""What a model can create, measured: pictures of scenes, what its latents hold, scenes that were never seen."""
