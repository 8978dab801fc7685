"""`[sensors]`: how what vehicles measure errs, of themselves (instruments.py) and of what is near (contacts.py)."""

from rl.perception.contacts import ContactsConfig
from rl.perception.instruments import InstrumentsConfig

MOST_DROPOUT = 0.99  # of measurements, however much errors are scaled


class SensorsConfig(InstrumentsConfig):
    """`[sensors]`: how instruments err; what is left out is exact."""

    contacts: ContactsConfig = ContactsConfig()

    @property
    def scaled_contacts(self) -> ContactsConfig:
        """Contacts with their errors times `errors`; in time as they are, unless there are none."""
        c, e = self.contacts, self.errors
        noise = {"range_noise": e * c.range_noise, "bearing_noise_deg": e * c.bearing_noise_deg}
        rest = {"dropout": min(e * c.dropout, MOST_DROPOUT), "late": c.late if e > 0 else 0}
        return c.model_copy(update=noise | rest)
