#!/usr/bin/env python3
"""How many times Mitsuba's efficiency holovol reaches: both in one run, taking turns.

Each round runs both of Mitsuba's integrators and then `holovol render`, all with new seeds.
The ratio is against the better integrator. Loading and compiling are outside all clocks.
"""

import argparse
import importlib.util
import json
import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
INTEGRATORS = ("volpath", "volpathmis")


def load_peer():
    """mitsuba.py under another name: its own would hide the package."""
    spec = importlib.util.spec_from_file_location("mitsuba_peer", HERE / "mitsuba.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def read_exr(path):
    import OpenEXR

    channels = OpenEXR.File(str(path)).channels()
    return channels["RGBA"].pixels if "RGBA" in channels else channels["RGB"].pixels


def output_of(command):
    result = subprocess.run(command, check=False, capture_output=True, text=True)
    if result.returncode:
        sys.exit(f"ratio.py: {shlex.join(map(str, command))} exited with {result.returncode}\n{result.stderr}")
    return result.stdout


def run_mitsuba(scene, integrator, args, first_seed):
    return json.loads(
        output_of(
            [sys.executable, HERE / "mitsuba.py", scene, "--integrator", integrator, "--spp", str(args.mitsuba_spp)]
            + ["--seeds", str(args.seeds), "--first-seed", str(first_seed)]
        )
    )


def run_holovol(peer, scene, args, seed, reference, floor):
    with tempfile.TemporaryDirectory() as folder:
        exr = Path(folder) / "holovol.exr"
        command = [args.holovol, "render", scene, "--out", exr, "--spp", str(args.spp), "--seed", str(seed)]
        report = json.loads(output_of(command + shlex.split(args.options)).splitlines()[-1])
        error = peer.relmse(read_exr(exr), reference) - floor
    return report | {"relmse": error}


def mean(values):
    values = list(values)
    return sum(values) / len(values)


def measure(peer, scene, args):
    reference = read_exr(scene.with_suffix(".ref.exr"))
    floor = json.loads(scene.with_suffix(".ref.json").read_text())["error_floor_relmse"]
    rounds = {name: [] for name in (*INTEGRATORS, "holovol")}
    for turn in range(args.rounds):
        for integrator in INTEGRATORS:
            rounds[integrator].append(run_mitsuba(scene, integrator, args, 1 + turn * args.seeds))
        for i in range(args.seeds):
            rounds["holovol"].append(run_holovol(peer, scene, args, 1 + turn * args.seeds + i, reference, floor))
        print(f"{scene.stem}: round {turn + 1} of {args.rounds} done", file=sys.stderr)

    summary = {}
    for name, reports in rounds.items():
        ours = name == "holovol"
        seconds = mean(r["seconds"] if ours else r["seconds_per_render"] for r in reports)
        error = mean(r["relmse"] for r in reports)
        spp = args.spp if ours else args.mitsuba_spp
        summary[name] = {
            "spp": spp,
            "seconds_per_render": seconds,
            "samples_per_second": mean(r["samples_per_second"] for r in reports),
            "relmse": error,
            "relmse_times_spp": error * spp,
            "efficiency": 1.0 / (error * seconds),
            "mean_rgb": [mean(r["mean_rgb"][c] for r in reports) for c in range(3)],
            "mean_opacity": mean(r["mean_opacity"] for r in reports),
        }
    best = max(INTEGRATORS, key=lambda name: summary[name]["efficiency"])
    return {
        "scene": scene.stem,
        "reference_floor_relmse": floor,
        "better_integrator": best,
        "efficiency_ratio": summary["holovol"]["efficiency"] / summary[best]["efficiency"],
        **summary,
        "adapter": rounds["holovol"][0]["adapter"],
        "cpu": rounds[best][0]["cpu"],
        "threads": rounds[best][0]["threads"],
        "mitsuba": rounds[best][0]["renderer"],
    }


def parse_arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    target = os.environ.get("CARGO_TARGET_DIR", Path.home() / ".cache/holovol/target")
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--holovol", type=Path, default=Path(target) / "release/holovol")
    parser.add_argument("--options", default="", help="further options for `holovol render`, in one string")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seeds", type=int, default=2, help="renders of each in a round (default 2)")
    parser.add_argument("--spp", type=int, default=64, help="holovol's samples per pixel (default 64)")
    parser.add_argument("--mitsuba-spp", type=int, default=16, help="Mitsuba's samples per pixel (default 16)")
    parser.add_argument("--json", type=Path, help="write the report here as well as to stdout")
    return parser.parse_args()


def main():
    args = parse_arguments()
    args.holovol = args.holovol.resolve()
    peer = load_peer()
    if not args.holovol.is_file():
        sys.exit(f"ratio.py: {args.holovol}: no such binary; build it with cargo build --release -p holovol")
    report = {
        **peer.provenance(),
        "scenes": [measure(peer, scene, args) for scene in args.scenes],
    }
    text = json.dumps(report, indent=2)
    print(text)
    if args.json:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
