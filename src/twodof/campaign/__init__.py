"""Campaigns: many flights of a plan over all cores, resumed after a kill, which return figures only."""

from twodof.campaign.plan import RowFile, Run, drawn, plan
from twodof.campaign.workers import campaign

__all__ = ["RowFile", "Run", "campaign", "drawn", "plan"]
