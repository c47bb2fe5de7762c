"""Infrastructure: cache folders, documents, provenance and code hashes."""
