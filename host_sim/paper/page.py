"""The page: every item of the paper beside ours, self-contained."""

from collections.abc import Mapping

from host_sim.paper.section import Section, Table
from host_sim.report import page

TITLE = "The paper's figures and tables beside ours"
CITATION = (
    "C. A. Peña Fernández, J. J. F. Cerqueira, A. M. N. Lima: Trajectory tracking control of an omnidirectional "
    "wheeled mobile robot with slip and deformation: a singular perturbation approach. Anais do XX Congresso "
    "Brasileiro de Automática, 2014, p. 32 ff."
)
HOW = (
    "Every run is the firmware itself, in-process behind a CAN bus, at 1 kHz in lockstep with the simulated robot: "
    "encoder speeds and exact pose in, motor torques out, all of it quantised as on the wire. The robot, the gains "
    "and ε are the paper's; what could not be reproduced is said where it belongs, with the reason where it is known."
)


def paper_page(sections: Mapping[str, Section], command: str) -> str:
    """Compose the page of the sections, by name."""
    rows = [[section.title, section.paper, section.ours] for section in sections.values()]
    blocks = [
        page.paragraph(CITATION),
        page.paragraph(HOW),
        page.contents({name: section.title for name, section in sections.items()}),
        page.table(Table("In short", ["", "paper", "ours"], rows)),
        page.heading("To repeat it"),
        page.command(command),
    ]
    for name, section in sections.items():
        blocks += [page.heading(section.title, name), page.figures(section.figures)]
        blocks += [page.table(table) for table in section.tables]
        blocks += [page.paragraph(remark) for remark in section.remarks]
    return page.compose(TITLE, "omnibot paper", blocks)
