"""What every stage uses: errors, the console, params, files, worker processes, resume, provenance."""
