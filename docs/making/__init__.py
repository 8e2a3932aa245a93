"""What the pages of docs/ have from the code: parameters, commands, Python's names, messages."""
