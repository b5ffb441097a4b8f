"""Exporters: datasets in the formats of other projects; one module for each format."""

from typing import Literal

from datagen.formats.exporters import movi, rgbd, webdataset
from datagen.formats.exporters.interface import Exporter

Format = Literal["webdataset", "movi", "rgbd"]

EXPORTERS: dict[Format, Exporter] = {
    "webdataset": webdataset.EXPORTER,
    "movi": movi.EXPORTER,
    "rgbd": rgbd.EXPORTER,
}
