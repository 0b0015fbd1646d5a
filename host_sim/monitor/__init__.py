"""A live view of a robot, or a simulation of one, by what goes over its bus. It listens and never sends.

`state.MonitorState` is fed with frames and knows everything; `listen` feeds it from a bus; `text`, `terminal` and
`server` only draw its snapshots.
"""
