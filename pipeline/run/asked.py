"""What a run was asked for, as the record in its cache keeps it: so that its OUT alone is enough to go on.

It stands in the cache and not among the results: these are passed on, and where a scan lies on a machine is
nobody else's matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from scanloom.pipeline.config import Config
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import described


@dataclass(frozen=True)
class Asked:
    """What a run was asked for.

    Attributes
    ----------
    scan : the folder or file of the scan, absolute.
    config : files in it are absolute, too.
    until : the last stage that was wanted.
    """

    scan: Path
    config: Config
    until: str

    def record(self) -> dict[str, str]:
        """Return it for JSON."""
        return {"scan": str(self.scan), "config": self.config.dumps(), "until": self.until}

    @classmethod
    def of(cls, record: object) -> Asked | None:
        """Return what a record says; None if it is none, or of a version that had other parameters."""
        if not isinstance(record, Mapping):
            return None
        scan, config, until = (record.get(name) for name in ("scan", "config", "until"))
        if not (isinstance(scan, str) and isinstance(config, str) and isinstance(until, str)):
            return None
        try:
            return cls(Path(scan), Config.loads(config), until)
        except UsageError:
            return None


def from_anywhere(config: Config) -> Config:
    """Return a configuration whose files are named in full, so that it holds in another folder, too."""
    for section, kind in config.types().items():
        params = getattr(config, section)
        named = {name: getattr(params, name) for name, about in described(kind).items() if about.is_path}
        in_full = {name: str(Path(path).absolute()) for name, path in named.items() if path is not None}
        if in_full:
            config = replace(config, **{section: replace(params, **in_full)})
    return config
