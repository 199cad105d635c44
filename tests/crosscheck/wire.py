#!/usr/bin/env python3
"""A cable that is slow, lossy or narrow, between two network namespaces: what `tc netem` does, where the kernel has none.

    wire.py NAMESPACE DEVICE NAMESPACE DEVICE DELAY_MS LOSS_PERCENT MBIT

Makes a tap device in each and carries frames from one to the other, both ways alike. MBIT 0 is as fast as it goes. A
frame that finds a second's worth of others before it is lost, as in a switch. Prints a line when the devices are
there, and ends with its parent, or when one of the devices goes away.
"""

import ctypes
import fcntl
import heapq
import os
import random
import select
import signal
import struct
import sys
import time

CLONE_NEWNET = 0x40000000
TUNSETIFF = 0x400454CA
IFF_TAP, IFF_NO_PI = 0x0002, 0x1000
PR_SET_PDEATHSIG = 1
FRAME = 65536
QUEUE_S = 1.0

libc = ctypes.CDLL(None, use_errno=True)


def tap(namespace, name):
    """A new tap device; the descriptor stays that of this namespace wherever the process goes."""
    with open("/run/netns/" + namespace, "rb") as place:
        if libc.setns(place.fileno(), CLONE_NEWNET) != 0:
            raise OSError(ctypes.get_errno(), "setns " + namespace)
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, TUNSETIFF, struct.pack("16sH22x", name.encode(), IFF_TAP | IFF_NO_PI))
    return device


class Way:
    """One of the two directions."""

    def __init__(self, device, delay, loss, rate, seed):
        self.device, self.delay, self.loss, self.rate = device, delay, loss, rate
        self.free_at = 0.0
        self.random = random.Random(seed)

    def take(self, now, frame):
        """When the frame comes out, or None if it does not."""
        if self.random.random() < self.loss:
            return None
        begins = max(now, self.free_at)
        if self.rate and begins - now > QUEUE_S:
            return None
        self.free_at = begins + (8e-6 * len(frame) / self.rate if self.rate else 0.0)
        return self.free_at + self.delay


def main(one, one_device, other, other_device, delay, loss, rate):
    libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    devices = [tap(one, one_device), tap(other, other_device)]
    delay, loss, rate = 1e-3 * float(delay), 0.01 * float(loss), float(rate)
    ways = {devices[end]: Way(devices[1 - end], delay, loss, rate, end) for end in (0, 1)}
    print("there", flush=True)
    on_the_way, number = [], 0
    while True:
        wait = max(0.0, on_the_way[0][0] - time.monotonic()) if on_the_way else None
        readable, _, _ = select.select(devices, [], [], wait)
        now = time.monotonic()
        for device in readable:
            try:
                # No more at a time than keeps the other end waiting for a moment.
                for _ in range(64):
                    frame = os.read(device, FRAME)
                    comes = ways[device].take(now, frame)
                    if comes is not None:
                        heapq.heappush(on_the_way, (comes, number, ways[device].device, frame))
                        number += 1
            except BlockingIOError:
                pass
            except OSError:
                # Down, or not up yet: what is sent is lost.
                time.sleep(0.001)
        while on_the_way and on_the_way[0][0] <= now:
            _, _, device, frame = heapq.heappop(on_the_way)
            try:
                os.write(device, frame)
            except OSError:
                pass


if __name__ == "__main__":
    if len(sys.argv) != 8:
        sys.exit(__doc__)
    main(*sys.argv[1:])
