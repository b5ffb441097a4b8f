"""Croissant metadata of datasets and exports: JSON-LD that dataset search engines and `mlcroissant` read."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from datagen.version import find_version

_TERMS = (
    "citeAs", "column", "equivalentProperty", "extract", "field", "fileProperty", "fileObject", "fileSet", "format",
    "includes", "isLiveDataset", "jsonPath", "key", "md5", "parentField", "path", "recordSet", "references", "regex",
    "repeated", "replace", "samplingRate", "separator", "source", "subField", "transform",
)  # fmt: skip
_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    **{term: f"cr:{term}" for term in _TERMS},
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "sc": "https://schema.org/",
}


@dataclass(frozen=True)
class Files:
    """A kind of file in a dataset."""

    glob: str
    """Pattern of their paths in the folder."""
    media_type: str
    description: str


def croissant(
    *,
    name: str,
    description: str,
    identity: str,
    license_url: str | None,
    files: Mapping[str, Files],
    splits: Mapping[str, int],
) -> str:
    """Text of a `croissant.json` file.

    Args:
        name: Name of the dataset.
        description: What it is.
        identity: Hash of the dataset's settings, which stands for its version.
        license_url: Address of its licence; None if it is unknown.
        files: Kinds of files by name.
        splits: Number of scenes of each split.
    """
    metadata = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": name,
        "description": description,
        **({"license": license_url} if license_url else {}),
        "version": find_version(),
        "identifier": identity,
        "citeAs": f"Generated with obpose-datagen {find_version()}",
        "creator": {"@type": "sc:Organization", "name": "obpose-datagen"},
        "distribution": [_file_set(key, kind) for key, kind in files.items()],
        "recordSet": [_splits(splits)],
    }
    return json.dumps(metadata, indent=2) + "\n"


def _file_set(name: str, files: Files) -> dict[str, Any]:
    return {
        "@type": "cr:FileSet",
        "@id": name,
        "name": name,
        "description": files.description,
        "encodingFormat": files.media_type,
        "includes": files.glob,
    }


def _splits(splits: Mapping[str, int]) -> dict[str, Any]:
    """Splits as records that are part of the file, since Croissant cannot describe arrays inside HDF5 or NPZ files."""
    columns = {"name": "sc:Text", "scenes": "sc:Integer"}
    return {
        "@type": "cr:RecordSet",
        "@id": "splits",
        "name": "splits",
        "description": "Splits and their numbers of scenes.",
        "dataType": "cr:Split",
        "key": {"@id": "splits/name"},
        "field": [
            {"@type": "cr:Field", "@id": f"splits/{column}", "name": column, "dataType": kind}
            for column, kind in columns.items()
        ],
        "data": [{"splits/name": name, "splits/scenes": scenes} for name, scenes in splits.items() if scenes],
    }
