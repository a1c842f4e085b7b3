"""What the fork server of the jobs has imported before the first one begins: a job then starts in milliseconds."""

import scipy.linalg
import scipy.optimize

import twodof.blocks
import twodof.compile
import twodof.design
import twodof.experiment
import twodof.identify
import twodof.lab.jobs.worker
import twodof.lab.logbook.log_work
import twodof.lab.workbench.diagram_jobs
import twodof.lab.workbench.diagram_work

WARM = (
    scipy.linalg,
    scipy.optimize,
    twodof.blocks,
    twodof.compile,
    twodof.design,
    twodof.experiment,
    twodof.identify,
    twodof.lab.jobs.worker,
    twodof.lab.logbook.log_work,
    twodof.lab.workbench.diagram_jobs,
    twodof.lab.workbench.diagram_work,
)
