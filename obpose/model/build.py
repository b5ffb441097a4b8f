"""Builder of ObPose: the parts of a configuration, composed."""

from typing import Any

from obpose.config import Config, ModelConfig
from obpose.model.attention.given import GivenMasks
from obpose.model.attention.heads import Heads
from obpose.model.attention.icsbp import ICSBP
from obpose.model.attention.interface import Attention
from obpose.model.attention.slot import SlotAttention
from obpose.model.backbone import Backbone
from obpose.model.layers.latent import LATENT, RecurrentLatent
from obpose.model.nerf.field import Field
from obpose.model.obpose import ObPose
from obpose.model.pose.encoder import ObjectEncoder
from obpose.model.pose.location import Where


def build_obpose(config: Config) -> ObPose:
    """Build a model with fresh weights from PyTorch's global generator."""
    return ObPose(config, **build_parts(config))


def build_parts(config: Config) -> dict[str, Any]:
    """Build the parts of a model by the names of `ObPose`'s arguments; weights are drawn in the order below."""
    model = config.model
    # Embeddings and masks.
    backbone = Backbone(model.backbone, scene_code=model.has_background and model.attention.kind != "slots")
    heads = Heads(model)
    attention = build_attention(model, heads)
    # Poses and latents.
    where_encoder = where = what_encoder = background = None
    if model.pose.conditioning in ("location", "full"):
        where_encoder = ObjectEncoder(heads.feature_size, model.latent)
        where = Where(where_encoder.size, model)
    if isinstance(attention, SlotAttention):
        object_code = background_code = attention.size
    else:
        what_encoder = ObjectEncoder(heads.feature_size, model.latent)
        object_code, background_code = what_encoder.size, backbone.scene_size
    what = RecurrentLatent(object_code, model.latent, weights=model.weights)
    if model.has_background:
        # As in the authors' code, posterior and prior start from learned hidden states; the paper does not define them.
        background = RecurrentLatent(background_code, model.latent, weights=model.weights, start="learned")
    # Fields.
    object_field = Field(model.object_field, LATENT, model.weights)
    background_field = Field(model.background_field, LATENT, model.weights) if model.has_background else None
    return {
        "backbone": backbone,
        "heads": heads,
        "attention": attention,
        "where_encoder": where_encoder,
        "where": where,
        "what_encoder": what_encoder,
        "what": what,
        "background": background,
        "object_field": object_field,
        "background_field": background_field,
    }


def build_attention(model: ModelConfig, heads: Heads) -> Attention:
    """Build the attention part of a configuration."""
    if model.attention.kind == "icsbp":
        return ICSBP(model)
    if model.attention.kind == "given":
        return GivenMasks()
    return SlotAttention(model, features=heads.feature_size)
