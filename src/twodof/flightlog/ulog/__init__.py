"""ULog, the format of PX4's logs: read from PX4, written by the virtual flight controller.

It is our own code because the library `pyulog` writes only what it has read before. It does not bound what a hostile
file makes it do: a file of 40 kB takes it 2 GiB and more than 15 s. On sound files it is as fast (.49 s for 6.6 MB
against .67 s). The tests read our files with it.
"""
