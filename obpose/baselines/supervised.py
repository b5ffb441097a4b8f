"""Supervised reference: the network, losses and inference of the contact model, trained with labels."""

from obpose.contact.model import ContactModel
from obpose.data.clips import ClipSource
from obpose.types import LabelledObservation


class Supervised(ContactModel):
    """Contact model whose training images are those of the dataset, with their labels."""

    observation_type = LabelledObservation

    def training_source(self, source: ClipSource) -> ClipSource:
        """Give the clips themselves."""
        return source
