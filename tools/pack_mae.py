"""Turn a training run's weights into those that ship with the package: float16, with how they came to be.

python tools/pack_mae.py runs/mae/best.safetensors
"""

import argparse
import json
from pathlib import Path

from refine.mae import load_mae
from train.checkpoints import save_weights

SHIPPED = Path(__file__).resolve().parents[1] / "refine" / "assets" / "mae.safetensors"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", type=Path, help="best.safetensors of `refine train mae`, its .json beside it")
    parser.add_argument("--out", type=Path, default=SHIPPED)
    args = parser.parse_args()
    record = json.loads(args.weights.with_suffix(".json").read_text())
    for written_again in ("schema", "kind", "config"):
        record.pop(written_again)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    save_weights(args.out, "mae", load_mae(args.weights), record, half=True)
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
