"""Content of docs/ generated from the code: parameters, commands, API, messages."""
