"""What is done to the text of whole functions: cut them into pieces, leave out what nothing reads."""
