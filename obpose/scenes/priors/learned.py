"""The prior that the model learned (paper, section Object Location and Orientation Conditioned Encoding)."""

from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.codes import CodePrior
from obpose.scenes.priors.interface import ScenePrior
from obpose.scenes.priors.mixture import normal
from obpose.scenes.priors.tables import no_tables


def learned_prior(origin: Origin) -> ScenePrior:
    """Give the normal priors of z_what and z_bg in a first frame.

    They do not cover positions and tables: objects are put in the middle half of the workspace, tables have no light
    and no texture.
    """
    model = origin.model
    assert model.background is not None
    half, middle = model.config.model.workspace_size / 4, model.center[:2]
    what, background = normal(*model.what.first()), normal(*model.background.first())
    return ScenePrior(CodePrior(what), background, no_tables(middle), middle - half, middle + half)
