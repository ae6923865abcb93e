"""Published measurements that results are set beside."""
