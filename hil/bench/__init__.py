"""Measurements that anyone can repeat: speed, fits and the paper's experiments, each beside its peers.

A benchmark returns a `Report` of tables; the command prints it and, when asked to, writes it with a manifest.
"""

from __future__ import annotations

BENCHMARKS = {
    "twin": "One ten-minute window of the coolant loop: our kernel, scipy, numpy, torch, jax, C",
    "fit": "The same windows fitted by our calibrators and by other people's optimisers",
    "paper": "The experiments of Energies 2026, 19, 2452, beside its figures",
    "hiera": "Who keeps a twin true on rigs never seen: swarm, least squares, filter, network",
    "ablations": "The network's pieces, each left out in turn, at the same CPU time of training",
    "discovery": "Blind trial of the diagnosis: hidden effects, sealed answers",
    "again": "A twin that took up an effect, asked again: nothing new, and a second effect",
    "faults": "Faults of wires, rig and harness: heater safe, no sample lost, no wrong value believed",
    "loop": "How evenly the loop ticks, its memory over 40 hours, and what a run that is killed loses",
    "structure": "Commissioned twins of four and of ten volumes on healthy rigs of another maker",
    "bus": "Round trips of the Modbus driver beside other people's clients; bus time of forty hours in lockstep",
    "wire": "Mutated Modbus replies and CAN frames: no wrong value is ever taken for a good one",
    "files": "Mutated files of every kind: each is read, or refused in a sentence that names it",
    "tower": "Calibrations of a cooling tower's outlet on a record: commissioned, persistence, regression, learned",
    "records": "Public records of other rigs, beside the published figures",
}
"""Name -> one line; each is a subcommand of `hil bench`."""
EXPERIMENTS = ("tracking", "randomised", "modules_heat", "tank_insulation")
"""Of `hil bench paper`."""
RIGS = ("virtual", "stranger", "inverse")
"""Where the paper's experiments run; see `hil.bench.experiments.campaigns`."""
