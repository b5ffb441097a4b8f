"""Exporters: datasets in the formats of other projects; one module for each format."""

from typing import Literal

from datagen.formats.exporters import bop, coco, movi, obpose, obsurf, rgbd, webdataset
from datagen.formats.exporters.interface import Exporter

Format = Literal["webdataset", "movi", "bop", "coco", "obsurf", "obpose", "rgbd"]

EXPORTERS: dict[Format, Exporter] = {
    "webdataset": webdataset.EXPORTER,
    "movi": movi.EXPORTER,
    "bop": bop.EXPORTER,
    "coco": coco.EXPORTER,
    "obsurf": obsurf.EXPORTER,
    "obpose": obpose.EXPORTER,
    "rgbd": rgbd.EXPORTER,
}
