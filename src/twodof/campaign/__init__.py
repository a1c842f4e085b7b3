"""Campaigns: many flights of a plan over all cores, resumed after a kill, of which only figures come back."""

from twodof.campaign.plan import Run, drawn, plan
from twodof.campaign.row_file import RowFile
from twodof.campaign.workers import campaign

__all__ = ["RowFile", "Run", "campaign", "drawn", "plan"]
