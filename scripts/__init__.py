"""Programs over both packages: studies, benchmarks, examples with real robots, tools."""
