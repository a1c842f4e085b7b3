"""Records until it is killed, and says on stdout what was acknowledged: the child of the crash tests."""

import sys
from pathlib import Path

import numpy as np

from twodof.flightlog.recorder import Recorder
from twodof.flightlog.ulog_writer import ULogWriter

PERIOD_NS = 4_000_000
FORMATS = {"imu_gyro": "uint64_t timestamp;double x;double y;double z;"}


def gyro(k: np.ndarray) -> np.ndarray:
    """(n, 3): what the samples numbered `k` hold."""
    return np.stack([np.sin(0.37 * k), 1.0 * k, -k / 3.0], axis=1)


def record_mcap(path: Path) -> None:
    """Two topics, in blocks of 50 samples each; prints how many blocks are on the disk, for which it waits."""
    with Recorder(path, ["imu.gyro", "estimate.theta"], {"seed": 7}, flush_s=0.01, full="wait") as recorder:
        block = 0
        while True:
            k = np.arange(50 * block, 50 * (block + 1))
            recorder.write_many("imu.gyro", PERIOD_NS * k, gyro(k))
            for one in k.tolist():
                recorder.write("estimate.theta", PERIOD_NS * one, 0.5 * one)
            block += 1
            # A sample is acknowledged once as many are as had been taken with it.
            sys.stdout.write(f"{recorder.acknowledged.samples // 100}\n")
            sys.stdout.flush()


def record_ulog(path: Path) -> None:
    """One topic; prints how many records are on the disk, for which it waits."""
    with ULogWriter(path, FORMATS, flush_s=0.01, full="wait") as writer:
        k = 0
        while True:
            for row in gyro(np.arange(k, k + 50)):
                writer.write("imu_gyro", 4000 * k, row.tolist())
                k += 1
            sys.stdout.write(f"{writer.acknowledged.samples}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    {"mcap": record_mcap, "ulg": record_ulog}[sys.argv[1]](Path(sys.argv[2]))
