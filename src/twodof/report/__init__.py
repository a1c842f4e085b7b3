"""The report a person wants to look at: `content` is what it says, `page` how it looks."""
