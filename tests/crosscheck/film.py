"""Reads a film by Pillow and prints what it holds as JSON: its pictures as they are seen, one after the other."""

import hashlib
import json
import sys

from PIL import Image, ImageSequence

with Image.open(sys.argv[1]) as film:
    frames = [(frame.convert("RGB"), frame.info.get("duration")) for frame in ImageSequence.Iterator(film)]
    print(
        json.dumps(
            {
                "format": film.format,
                "size": film.size,
                "loop": film.info.get("loop"),
                "durations_ms": [duration for _, duration in frames],
                "digests": [hashlib.sha256(frame.tobytes()).hexdigest() for frame, _ in frames],
                "corners": [frame.getpixel((1, 1)) for frame, _ in frames],
                "middles": [frame.getpixel((frame.width // 2, frame.height // 2)) for frame, _ in frames],
                "colors": max(len(frame.getcolors(1 << 24)) for frame, _ in frames),
            }
        )
    )
