"""Options that several commands share: one name, one meaning, one help line."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twodof.blocks.noise import SEEDS


class RealType(StrEnum):
    """The reals of compiled code."""

    float64 = "float64"
    float32 = "float32"


_SYSTEMS = 199
"""A client may be system 200 and above."""

Index = Annotated[int, typer.Option(min=0, max=_SYSTEMS - 1, help="Number of the drone: system is index + 1.")]
Rig = Annotated[str, typer.Option(help="lab, paper, or a JSON file of rig parameters.")]
Lockstep = Annotated[
    bool, typer.Option("--lockstep", help="Time stands still until a client grants it; faster than real time.")
]
Seed = Annotated[int, typer.Option(min=0, max=SEEDS - 1, help="Seed of the noise.")]
Noise = Annotated[float, typer.Option(min=0.0, max=100.0, help="Gain of all noise; 0: none.")]
Charge = Annotated[
    float, typer.Option(min=0.0, max=1.0, help="State of charge of the battery at the start; thrust sags with it.")
]
Rings = Annotated[bool, typer.Option("--rings/--free", help="The rings lock the cart: pitch only.")]
SafetySwitch = Annotated[
    bool, typer.Option("--safety-switch/--no-safety-switch", help="Whether it was pressed, so that motors may turn.")
]
Trust = Annotated[bool, typer.Option("--trust", help="Compile those controllers into the flight code: no sandbox.")]
Precision = Annotated[str, typer.Option(help="float64, or float32 as a flight controller computes.")]
Fresh = Annotated[
    bool, typer.Option("--fresh", help="Begin with the default parameters, and without controllers that were sent.")
]
KeyFile = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Sign everything with this key and take in nothing unsigned.")
]
PromiseFile = Annotated[
    Path | None, typer.Option("--promise", metavar="FILE", help="Write what is promised there, as JSON.")
]
PromisePlot = Annotated[Path | None, typer.Option(metavar="FILE", help="Draw the promise (.png, .svg, .pdf, .html).")]
PageHost = Annotated[
    str, typer.Option("--host", help="Address to serve the page at; one that others reach needs the token in the link.")
]
PageToken = Annotated[
    bool, typer.Option("--token", help="Let nobody in without the link, other users of this computer too.")
]
OpenPage = Annotated[bool, typer.Option("--open", help="Open the page in the browser.")]
