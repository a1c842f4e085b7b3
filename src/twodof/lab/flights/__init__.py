"""Experiments flown and identified for the page: what runs in the processes of jobs, and where flights are kept."""
