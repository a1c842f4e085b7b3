"""MATLAB as Simulink's files hold it: numbers of masks and scripts, and the code of MATLAB Functions."""
