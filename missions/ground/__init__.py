"""What every room stands on: rigs, options, journals, folders of runs, work in processes."""
