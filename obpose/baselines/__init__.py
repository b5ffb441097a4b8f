"""Other authors' models under the contracts of `obpose.trainable`, written anew from what they published."""
