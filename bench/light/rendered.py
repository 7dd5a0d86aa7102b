"""Volumes lit by an estimate, and by the LDR panorama as it is, against the same lit by the truth.

python rendered.py HOLOVOL OUT_FOLDER LIGHT.json SCENE.json …   (needs numpy, OpenEXR, Pillow)

Each scene's panorama is turned four times and exposed so that 0.5, 2 and 8 % of it clip, saved as
8-bit sRGB, given to `holovol light` with the prior that was fitted without it (LIGHT.json is what
`holovol bench light` printed), and the scene is rendered under truth, LDR and estimate, with two
seeds each. relMSE of the volume's radiance over the truth's, as the mean product of both seeds'
differences: their noise is independent, so that it adds nothing to the mean, where squares of one
seed's would make two good lights look equally bad.
"""
import json, os, subprocess, sys
import numpy as np, OpenEXR
from PIL import Image

WIDTH, SPP, CLIPPED = 96, 64, (0.005, 0.02, 0.08)
SEEDS, TURNS = (1, 2), 4


def run(*args):
    return json.loads(subprocess.run(args, check=True, capture_output=True, text=True).stdout)


def rgb(path):
    channels = OpenEXR.File(path).channels()
    key = next(key for key in channels if key.startswith("RGB"))
    return np.asarray(channels[key].pixels)[..., :3]


def expose(truth, level, ldr, linear):
    """Saves what an 8-bit picture shows, as a picture and as the radiance that it stands for."""
    x = np.clip(truth / level, 0, 1)
    code = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    picture = (code * 255 + 0.5).astype(np.uint8)
    Image.fromarray(picture).save(ldr)
    z = picture / 255.0
    radiance = np.where(z <= 0.04045, z / 12.92, ((z + 0.055) / 1.055) ** 2.4)
    write(linear, radiance)


def write(path, radiance):
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": radiance.astype(np.float32)}).write(path)


def main(holovol, out, light, scenes):
    out = os.path.abspath(out)
    os.makedirs(out, exist_ok=True)
    priors = {entry["name"]: entry["prior"] for entry in json.load(open(light))["rungs"][0]["panoramas"]}
    cases = []
    print("| scene | clipped | LDR as it is | estimate | ratio: least, most |\n|---|---|---|---|---|")
    for path in scenes:
        name = os.path.basename(path).removesuffix(".json")
        scene = json.load(open(path))
        folder = os.path.dirname(os.path.abspath(path))
        environment = scene["environment"]
        if "path" not in environment:
            print(f"{name}: constant light, skipped")
            continue
        scene["volume"]["path"] = os.path.join(folder, scene["volume"]["path"])
        scene.pop("animation", None)
        file = lambda kind, end: os.path.join(out, f"{name}.{kind}.{end}")
        scale = environment.get("scale", 1.0)
        stem = os.path.basename(environment["path"]).rsplit(".", 1)[0].removesuffix("_1k")
        json.dump(priors[stem], open(file("prior", "json"), "w"))

        def render(kind, factor):
            scene["environment"] = {**environment, "path": file(f"{kind}_map", "exr"), "scale": scale * factor}
            json.dump(scene, open(file(kind, "json"), "w"))
            for seed in SEEDS:
                run(holovol, "render", file(kind, "json"), "--out", file(f"{kind}{seed}", "exr"), "--png",
                    file(kind, "png"), "--spp", str(SPP), "--width", str(WIDTH), "--backend", "reference",
                    "--seed", str(seed))
            return [rgb(file(f"{kind}{seed}", "exr")) for seed in SEEDS]

        # Reading it is left to holovol: an HDR picture passes through.
        run(holovol, "light", "--ldr", os.path.join(folder, environment["path"]), "--out",
            file("truth_map", "exr"))
        panorama = rgb(file("truth_map", "exr"))
        errors = {share: [] for share in CLIPPED}
        for turn in range(TURNS):
            turned = np.roll(panorama, turn * panorama.shape[1] // TURNS, axis=1)
            write(file("truth_map", "exr"), turned)
            # One exposure for all pictures, so that they can be looked at side by side.
            truth = render("truth", 1.0)
            mean = sum(truth) / len(truth)

            def relmse(images):
                first, second = (image - true for image, true in zip(images, truth))
                return float(np.mean(first * second / (mean * mean + 0.01)))

            for share in CLIPPED:
                ldr, estimate = f"ldr_{share}", f"estimate_{share}"
                level = float(np.quantile(panorama.max(-1), 1 - share))
                expose(turned, level, file(ldr, "8bit.png"), file(f"{ldr}_map", "exr"))
                run(holovol, "light", "--ldr", file(ldr, "8bit.png"), "--prior", file("prior", "json"),
                    "--out", file(f"{estimate}_map", "exr"), "--preview", file(f"lights_{share}", "png"))
                errors[share].append([relmse(render(kind, level)) for kind in (ldr, estimate)])
        for share, pairs in errors.items():
            cases += pairs
            ratios = [estimate / ldr for ldr, estimate in pairs]
            ldr, estimate = np.mean(pairs, axis=0)
            print(f"| {name} | {100 * share:g} % | {ldr:.2g} | {estimate:.2g} | {estimate / ldr:.3f}: "
                  f"{min(ratios):.3f}, {max(ratios):.3f} |", flush=True)
    cases = np.array(cases)
    ratios, (ldr, estimate) = cases[:, 1] / cases[:, 0], cases.mean(axis=0)
    print(f"| mean of {len(cases)} | | {ldr:.2g} | {estimate:.2g} | {estimate / ldr:.3f} |")
    print(f"\nRatios: median {np.median(ratios):.3f}, mean {ratios.mean():.3f}, 90th percentile "
          f"{np.quantile(ratios, 0.9):.3f}; {np.mean(ratios <= 1 / 3):.0%} at most a third.")


main(sys.argv[1], sys.argv[2], sys.argv[3], sys.argv[4:])
