"""Volumes lit by an estimate, and by the LDR panorama as it is, against the same lit by the truth.

python rendered.py HOLOVOL OUT_FOLDER SCENE.json …   (needs numpy, OpenEXR, Pillow)

Each scene's panorama is exposed so that 2 % of it clip, saved as 8-bit sRGB, given to `holovol
light`, and the scene is rendered under truth, LDR and estimate, with two seeds each. relMSE of the
volume's radiance over the truth's, as the mean product of both seeds' differences: their noise is
independent, so that it adds nothing to the mean, where squares of one seed's would make two good
lights look equally bad. The shipped prior, which has seen these panoramas.
"""
import json, os, subprocess, sys
import numpy as np, OpenEXR
from PIL import Image

WIDTH, SPP, CLIPPED = 96, 64, 0.02


def run(*args):
    return json.loads(subprocess.run(args, check=True, capture_output=True, text=True).stdout)


def rgb(path):
    channels = OpenEXR.File(path).channels()
    key = next(key for key in channels if key.startswith("RGB"))
    return np.asarray(channels[key].pixels)[..., :3]


def main(holovol, out, scenes):
    out = os.path.abspath(out)
    os.makedirs(out, exist_ok=True)
    for path in scenes:
        name = os.path.basename(path).removesuffix(".json")
        scene = json.load(open(path))
        folder = os.path.dirname(os.path.abspath(path))
        environment = scene["environment"]
        if "path" not in environment:
            print(f"{name}: constant light, skipped")
            continue
        scene["volume"]["path"] = os.path.join(folder, scene["volume"]["path"])
        panorama = os.path.join(folder, environment["path"])
        # Reading it is left to holovol: an HDR picture passes through.
        file = lambda kind, end: os.path.join(out, f"{name}.{kind}.{end}")
        run(holovol, "light", "--ldr", panorama, "--out", file("truth_map", "exr"))
        truth = rgb(file("truth_map", "exr"))
        level = np.quantile(truth.max(-1), 1 - CLIPPED)
        x = np.clip(truth / level, 0, 1)
        code = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
        Image.fromarray((code * 255 + 0.5).astype(np.uint8)).save(file("ldr", "png"))
        report = run(holovol, "light", "--ldr", file("ldr", "png"), "--out", file("estimate_map", "exr"),
                     "--preview", file("lights", "png"))
        z = np.asarray(Image.open(file("ldr", "png"))) / 255.0
        linear = np.where(z <= 0.04045, z / 12.92, ((z + 0.055) / 1.055) ** 2.4).astype(np.float32)
        OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": linear}).write(file("ldr_map", "exr"))
        scale = environment.get("scale", 1.0)
        scene.pop("animation", None)
        # One exposure for all pictures, so that they can be looked at side by side.
        images = {}
        for kind, factor in (("truth", 1.0), ("ldr", float(level)), ("estimate", float(level))):
            scene["environment"] = {**environment, "path": file(f"{kind}_map", "exr"), "scale": scale * factor}
            json.dump(scene, open(file(kind, "json"), "w"))
            for seed in (1, 2):
                run(holovol, "render", file(kind, "json"), "--out", file(f"{kind}{seed}", "exr"), "--png",
                    file(kind, "png"), "--spp", str(SPP), "--width", str(WIDTH), "--backend", "reference",
                    "--seed", str(seed))
                images[kind, seed] = rgb(file(f"{kind}{seed}", "exr"))
        truth = 0.5 * (images["truth", 1] + images["truth", 2])

        def relmse(kind):
            first, second = (images[kind, seed] - images["truth", seed] for seed in (1, 2))
            return float(np.mean(first * second / (truth * truth + 0.01)))

        ldr, estimate = relmse("ldr"), relmse("estimate")
        print(f"| {name} | {ldr:.2g} | {estimate:.2g} | {estimate / ldr:.3f} | {report['sigma_ev']:.2f} |", flush=True)


main(sys.argv[1], sys.argv[2], sys.argv[3:])
