"""The routes of the API, a file a subject: each translates a request into a call of the library."""
