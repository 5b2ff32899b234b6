"""The record of nights: queues, visits, stages, exposures, commands, alarms."""
