"""Write the values of reference implementations for `OTHER_METRICS` into the golden cases.

Needs packages that the tests do not: HOTA, IDF1 and J&F come from TrackEval, PQ and F1 from TorchMetrics, AMI and
average precision from scikit-learn. The values in the file were made with

pip install trackeval==1.3.0 torchmetrics==1.9.0 opencv-python-headless tabulate pycocotools
python -m tests.benchmark.metrics.other_references
"""

import json
from pathlib import Path

import numpy as np
import torch
from pycocotools.mask import encode
from sklearn.metrics import adjusted_mutual_info_score, average_precision_score
from torchmetrics.functional.detection import panoptic_quality  # pyright: ignore[reportMissingImports]
from trackeval.metrics import HOTA, Identity, JAndF  # pyright: ignore[reportMissingImports]

import benchmark.metrics
from benchmark.commands.selftest import golden, label_maps

PATH = Path(benchmark.metrics.__file__).with_name("golden_cases.json")


def iou(one: np.ndarray, two: np.ndarray) -> float:
    return np.sum(one & two) / np.sum(one | two)


def over_time(truth: np.ndarray, prediction: np.ndarray) -> dict[str, float]:
    """Values of TrackEval; label 0 is the background of both."""
    names = [[int(name) for name in np.unique(maps) if name] for maps in (truth, prediction)]
    data: dict = {"num_timesteps": len(truth), "num_gt_ids": len(names[0]), "num_tracker_ids": len(names[1])}
    there = [
        [[name for name in known if np.any(labels == name)] for labels in maps]
        for maps, known in zip((truth, prediction), names, strict=True)
    ]
    for key, maps, known, present in zip(("gt", "tracker"), (truth, prediction), names, there, strict=True):
        data[f"{key}_ids"] = [np.array([known.index(name) for name in frame], int) for frame in present]
        data[f"{key}_dets"] = [
            [encode(np.asfortranarray(labels == name, np.uint8)) for name in frame]
            for labels, frame in zip(maps, present, strict=True)
        ]
        data[f"num_{key}_dets"] = sum(map(len, present))
    data["similarity_scores"] = [
        np.array([[iou(t == a, p == b) for b in two] for a in one]).reshape(len(one), len(two))
        for t, p, one, two in zip(truth, prediction, *there, strict=True)
    ]
    both = JAndF()
    both.optim_type = "J&F"
    return {
        "hota": float(np.mean(HOTA().eval_sequence(data)["HOTA"])),
        "idf1": float(Identity({"PRINT_CONFIG": False}).eval_sequence(data)["IDF1"]),
        "j_and_f": float(both.eval_sequence(data)["J&F"]),
    }


def of_frame(truth: np.ndarray, prediction: np.ndarray) -> dict[str, float]:
    """Values of TorchMetrics and scikit-learn for a frame with objects."""
    maps = [np.stack([labels > 0, labels], axis=-1)[None].astype(np.int64) for labels in (prediction, truth)]
    pairs = map(torch.from_numpy, maps)
    quality = panoptic_quality(*pairs, things={1}, stuffs={0}, return_sq_and_rq=True, return_per_class=True)[0]
    objects, segments = (np.unique(labels[labels > 0]) for labels in (truth, prediction))
    hits = [any(iou(truth == thing, prediction == slot) > 0.5 for thing in objects) for slot in segments]
    precision = average_precision_score(hits, np.ones(len(hits))) if any(hits) else 0.0
    inside = truth > 0
    return {
        "ap50": float(precision * sum(hits) / len(objects)),
        "pq": float(quality[0]),
        "f1": float(quality[2]),
        "ami_fg": float(adjusted_mutual_info_score(truth[inside], prediction[inside])),
    }


def main() -> None:
    values = json.loads(json.dumps(golden()))
    for case in values["cases"]:
        if case["kind"] not in ("image", "video"):
            continue
        truth, prediction = label_maps(case)
        frames = [of_frame(*pair) for pair in zip(truth, prediction, strict=True) if np.any(pair[0] > 0)]
        found = {name: float(np.mean([frame[name] for frame in frames])) for name in (frames[0] if frames else ())}
        whole = [adjusted_mutual_info_score(*map(np.ravel, pair)) for pair in zip(truth, prediction, strict=True)]
        found["ami"] = float(np.mean(whole))
        if len(truth) > 1:
            found |= over_time(truth, prediction)
        sources: dict[str, str] = dict.fromkeys(("hota", "idf1", "j_and_f"), "TrackEval") | dict.fromkeys(
            ("pq", "f1"), "torchmetrics"
        )
        for name, value in found.items():
            source = sources.get(name, "scikit-learn")
            entry = {"expected": round(value, 10), "reference": source, "peers": {source: round(value, 10)}}
            case["metrics"][name] = entry
    values["versions"] |= {"trackeval": "1.3.0"}
    PATH.write_text(json.dumps(values, separators=(",", ":")), encoding="utf-8")


if __name__ == "__main__":
    main()
