"""Read and write KITTI raw: layout, calibration, packets, scans; write the ingest file."""
