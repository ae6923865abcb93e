"""Published measurements that results are compared with."""
