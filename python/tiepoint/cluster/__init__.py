"""Reconstruction on a Ray cluster: `reconstruct`, and `python -m tiepoint.cluster`.

The shards and sub-maps of the program (docs/design/scale.md) are tasks of Ray, which places them,
and runs them again when a node is lost. The rows of the database and the models are those of one
process, on any number of nodes.
"""

try:
    import ray as _ray  # noqa: F401
except ImportError:
    why = "tiepoint.cluster needs Ray: pip install 'tiepoint[ray]'"
    # With the name, `python -m` says it in one line.
    raise ImportError(why, name=__name__) from None

from .driver import reconstruct
from .report import NodeTotals, Report, StageTotals
from .tasks import Work

__all__ = ["NodeTotals", "Report", "StageTotals", "Work", "reconstruct"]
