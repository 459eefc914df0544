"""A sample's files and nothing else: codecs, samples, manifests, loaders. Never renders."""
