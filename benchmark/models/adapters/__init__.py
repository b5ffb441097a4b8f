"""Learned systems as benchmark models, and label maps made elsewhere.

PyTorch is imported only when a model is built, as that takes seconds.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from benchmark.models.interface import Segmenter
from benchmark.models.model_spec import ModelSpec, Options, Views, settings_of
from obpose.systems import SYSTEMS, System, priors_of

LABELLED_TRIALS: dict[str, int] = {
    "obpose": 70,
    "supervised": 12,
    "obsurf": 30,
    "contact": 12,
    "ogc": 3,
    "obpose-contact": 12,
}
"""Approximate number of short runs that were compared with labels of validation scenes, by architecture; see
docs/results/search.md."""


def _build(name: str, options: Options) -> Segmenter:
    from benchmark.models.adapters.learned import LearnedSegmenter

    return LearnedSegmenter(name, **options)


def _spec(name: str, system: System) -> ModelSpec:
    config = system.config()
    return ModelSpec(
        partial(_build, name),
        version=system.version,
        description=system.description,
        kind="learned",
        uses_labels=system.uses_labels,
        priors=system.priors,
        budget=60 * config.train.minutes,
        extra=system.extra,
        labelled_trials=LABELLED_TRIALS[system.architecture.name],
        settings=settings_of(config),
        profiles={name: settings_of(system.config(name)) for name in system.architecture.profiles if name != "cpu"},
        views=_views(config),
        configured=partial(_configured, name),
        on_tracks=system.on_tracks,
        at_test=system.at_test,
    )


def _configured(name: str, folder: Path) -> ModelSpec:
    from obpose.storage.checkpoint import read_config

    config = read_config(folder)
    return replace(LEARNED[name], priors=priors_of(config), views=_views(config))


def _views(config: Any) -> Views:
    return {"all": Views("all", "all"), "random": Views("one", "all"), "separate": Views("one", "one")}[
        config.train.views
    ]


LEARNED = {name: _spec(name, system) for name, system in SYSTEMS.items()}
