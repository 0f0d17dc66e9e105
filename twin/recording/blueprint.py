"""How a recording opens: everything in sight at once."""

from __future__ import annotations

from collections.abc import Sequence

import rerun.blueprint as rrb

from twin.recording import views
from twin.recording.plots import PLOTS, evidence_lines
from twin.recording.scenery import bounds
from twin.world import World

TOP_ASPECT = 2.0  # width over height of the top view in a 16:9 window, a little less to be safe


def layout(world: World, learned: bool, labels: Sequence[str] = ()) -> rrb.Blueprint:
    """The blueprint of a recording in `world`.

    `learned`: a context classifier drives, so there is a confidence; `labels`: contexts whose evidence is recorded.
    """
    scenes = rrb.Horizontal(
        views.top_view(bounds(world), TOP_ASPECT),
        rrb.Vertical(views.robot_view(), views.summary(), row_shares=[1.6, 1.0]),
        column_shares=[2.0, 1.0],
    )
    columns = [
        rrb.Vertical(views.lanes(), views.events()),
        rrb.Vertical(_plot("speed [m/s]"), _plot("turn rate [rad/s]", legend=False)),  # same colours
        rrb.Vertical(_plot("clearance [m]", legend=False), _plot("confidence" if learned else "chosen arc")),
        rrb.Vertical(_plot("parameters"), _plot("samples"), row_shares=[2.1, 1.0]),
    ]
    shares = [1.0, 1.0, 1.0, 1.15]
    if labels:
        columns[2:3] = [
            rrb.Vertical(_plot("clearance [m]", legend=False), _plot("chosen arc")),
            rrb.Vertical(_plot("confidence"), views.plot("evidence", evidence_lines(labels))),
        ]
        shares = [1.0, 0.9, 0.9, 0.9, 1.0]
    charts = rrb.Horizontal(*columns, column_shares=shares)
    return views.opened(rrb.Vertical(scenes, charts, row_shares=[1.5, 1.0]))


def _plot(name: str, legend: bool = True) -> rrb.TimeSeriesView:
    return views.plot(name, PLOTS[name], legend=legend)
