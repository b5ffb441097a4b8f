"""Upload a dataset or an export to the Hugging Face hub; needs the extra `push`, and nothing else does."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from datagen.errors import DatagenError, UsageError
from datagen.formats.export import is_export
from datagen.storage.atomic import target_name
from datagen.storage.reader import Dataset
from datagen.storage.spec import CARD_FILE, CROISSANT_FILE, SPEC_FILE

MOST_FILES = 100_000
"""Largest number of files in a repository that the hub recommends."""

_REPOSITORY = re.compile(r"[A-Za-z0-9][\w.-]{0,95}/[A-Za-z0-9][\w.-]{0,95}", re.ASCII)


@dataclass(frozen=True)
class Upload:
    """Files that an upload consists of."""

    repository: str
    files: tuple[str, ...]
    """Paths in the folder."""
    size: int
    """Bytes of all files."""

    @property
    def address(self) -> str:
        """Address of the repository."""
        return f"https://huggingface.co/datasets/{self.repository}"


def plan_upload(folder: Path, repository: str) -> Upload:
    """Check a folder and list its files; needs neither a network nor the extra.

    Raises:
        UsageError: the repository's name is malformed, or the folder holds no dataset and no export.
        DatagenError: the dataset is incomplete, or its card is missing.
    """
    if not _REPOSITORY.fullmatch(repository):
        raise UsageError(
            f"{repository:.80} cannot be the name of a dataset on the hub; expected OWNER/NAME of letters, digits, "
            "dots, dashes and underscores, such as ada/moving."
        )
    if not is_export(folder):
        Dataset(folder).check_complete()
    if missing := [name for name in (CARD_FILE, CROISSANT_FILE) if not (folder / name).is_file()]:
        made = "generation" if (folder / SPEC_FILE).exists() else "export"
        raise DatagenError(f"{folder} has no {missing[0]}; run the {made} again, which writes it.")
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and target_name(path) == path.name]
    files = [path for path in paths if not any(part.startswith(".") for part in path.relative_to(folder).parts)]
    if len(files) > MOST_FILES:
        raise UsageError(
            f"{folder} has {len(files):,} files, expected at most {MOST_FILES:,} in a repository of the hub. Push the "
            "dataset itself, or an export to webdataset, which have few files."
        )
    names = tuple(str(path.relative_to(folder)) for path in files)
    return Upload(repository, names, sum(path.stat().st_size for path in files))


def push(folder: Path, upload: Upload, *, private: bool, hub: Callable[[], Any] | None = None) -> None:
    """Create the repository if necessary and upload the files in one commit.

    Args:
        folder: Folder of the files.
        upload: What `plan_upload` gave.
        private: Whether a new repository is private.
        hub: Function that makes the client; None takes that of huggingface-hub.

    Raises:
        UsageError: huggingface-hub is not installed.
        DatagenError: the hub cannot be reached, or refuses.
    """
    client = (hub or _client)()
    settings = {"repo_id": upload.repository, "repo_type": "dataset"}
    try:
        client.create_repo(**settings, private=private, exist_ok=True)
        client.upload_folder(
            **settings,
            folder_path=folder,
            ignore_patterns=[".*", "*/.*"],  # hidden, as temporary files are, at any depth
            commit_message="Upload with obpose-datagen push",
        )
    except Exception as error:  # the client passes on errors of several HTTP libraries
        reason = next(iter(str(error).strip().splitlines()), "") or type(error).__name__
        raise DatagenError(
            f"The upload to {upload.address} failed ({reason:.300}). Log in with `hf auth login` or set HF_TOKEN, "
            "check the network and that you may write there, and run the same command again; files that have arrived "
            "are not sent twice."
        ) from error


def _client() -> Any:
    try:
        from huggingface_hub import HfApi
    except ImportError:
        raise UsageError("Uploading needs huggingface-hub; install it with: pip install 'obpose[push]'") from None
    return HfApi()
