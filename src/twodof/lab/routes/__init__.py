"""The routes of the API, one file for each subject. Each route translates a request into a call of the library."""
