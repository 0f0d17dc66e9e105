"""How much time could one parameter set gain? `python examples/headroom.py --worlds 20 --evaluations 40`

A diagnosis, never part of APPLI (scenarios/headroom.py). That line takes some minutes, the defaults some seconds.
"""

import json
from dataclasses import asdict, dataclass, field

import tyro

from scenarios.errors import one_line_errors
from scenarios.headroom import Options, brief, measure


@dataclass(frozen=True, slots=True)
class Arguments:
    """Search one parameter set for the least mean traversal time, and compare it with the default on fresh seeds."""

    search: tyro.conf.OmitArgPrefixes[Options] = field(default_factory=Options)
    json: bool = False  # print one JSON object on stdout and nothing else


def main(arguments: Arguments) -> None:
    """Measure and print."""
    found = measure(arguments.search)
    drivers = {name: asdict(drives) for name, drives in found.drivers.items()}
    if arguments.json:
        print(json.dumps({"drives": found.drives, "share": found.share, "params": found.params.as_dict()} | drivers))
        return
    print(f"{found.drives} drives each   time [s]  reached  gain [s]  +- [s]")
    for name, row in drivers.items():
        print(f"{name:16s}{row['time']:9.2f}{row['reached']:9.2f}{row['gain']:10.2f}{row['gain_error']:8.2f}")
    print(f"optimum: {brief(found.params)}")
    if found.share is not None:
        print(f"the policy reaches {found.share:.2f} of the optimum's gain")


if __name__ == "__main__":
    with one_line_errors():
        main(tyro.cli(Arguments))
