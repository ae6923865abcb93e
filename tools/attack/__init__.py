"""An attack on the real command: damaged media, hostile names, limits, signals, disks, servers.

    make attack CASES=5000 SEED=1

The seed and the number of a case determine everything in it. Every case runs in its own folder;
then the attack checks the files, processes and messages that the command has left behind. It keeps
the files and the command line of each case that fails.
"""  # fmt: skip
