"""Tables for pandas, MATLAB, R and spreadsheets: Parquet and CSV."""
