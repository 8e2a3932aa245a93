"""What readers of scan folders share: files, parameters, streams, rigs, views, axes."""
