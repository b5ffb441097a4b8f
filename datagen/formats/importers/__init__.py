"""Importers: datasets of other projects as dataset folders; one module for each format."""

from datagen.formats.import_request import Format
from datagen.formats.importers.bop import find_bop
from datagen.formats.importers.interface import Importer
from datagen.formats.importers.obpose import find_obpose
from datagen.formats.importers.obsurf import find_obsurf
from datagen.formats.importers.octscenes import find_octscenes
from datagen.formats.importers.rgbd import find_rgbd

IMPORTERS: dict[Format, Importer] = {
    "rgbd": find_rgbd,
    "obsurf": find_obsurf,
    "obpose": find_obpose,
    "bop": find_bop,
    "octscenes": find_octscenes,
}
