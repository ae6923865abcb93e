"""An attack on the real command: damaged media, hostile names, limits, signals, disks, servers.

    make attack CASES=5000 SEED=1

Each case is made from its number and the seed alone, runs in a folder of its own, and is judged
by what it leaves behind. Cases that fail are kept with their files and their command line.
"""  # fmt: skip
