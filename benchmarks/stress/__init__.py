"""What readers do with damaged and hostile files: the long version of tests/benchmarks/test_stress.py."""
