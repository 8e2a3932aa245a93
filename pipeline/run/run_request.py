"""Arguments of a run, recorded in the cache.

The record allows the run to be continued from its OUT alone.

The record is not among the results: results are shared with others, and paths of the local machine are
private.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from scanloom.pipeline.config import Config
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import describe_own


@dataclass(frozen=True)
class RunRequest:
    """Recorded arguments of a run.

    Attributes
    ----------
    scan : absolute path of the scan folder or file.
    config : configuration with absolute paths.
    until : last requested stage.
    """

    scan: Path
    config: Config
    until: str

    def to_json(self) -> dict[str, str]:
        """Return the arguments as JSON values."""
        return {"scan": str(self.scan), "config": self.config.dumps(), "until": self.until}

    @classmethod
    def from_record(cls, record: object) -> RunRequest | None:
        """Parse recorded arguments; None if invalid or from a version with other parameters."""
        if not isinstance(record, Mapping):
            return None
        scan, config, until = (record.get(name) for name in ("scan", "config", "until"))
        if not (isinstance(scan, str) and isinstance(config, str) and isinstance(until, str)):
            return None
        try:
            return cls(Path(scan), Config.loads(config), until)
        except UsageError:
            return None


def make_paths_absolute(config: Config) -> Config:
    """Make the paths in a configuration absolute.

    The configuration is then valid in any working directory.
    """
    for section, kind in config.get_types().items():
        params = getattr(config, section)
        named = {name: getattr(params, name) for name, about in describe_own(kind).items() if about.is_path}
        in_full = {name: str(Path(path).absolute()) for name, path in named.items() if path is not None}
        if in_full:
            config = replace(config, **{section: replace(params, **in_full)})
    return config
