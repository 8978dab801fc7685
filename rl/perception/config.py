"""`[sensors]`: errors of a vehicle's own instruments (instruments.py), and of contacts near it (contacts.py)."""

from rl.perception.contacts import ContactsConfig
from rl.perception.instruments import InstrumentsConfig

MOST_DROPOUT = 0.99  # share of measurements, the most after scaling


class SensorsConfig(InstrumentsConfig):
    """`[sensors]`: errors of instruments and contacts; what is left out is exact."""

    contacts: ContactsConfig = ContactsConfig()

    @property
    def scaled_contacts(self) -> ContactsConfig:
        """Contacts with their errors multiplied by `errors`; their delay stays, unless `errors` is 0."""
        c, e = self.contacts, self.errors
        noise = {"range_noise": e * c.range_noise, "bearing_noise_deg": e * c.bearing_noise_deg}
        rest = {"dropout": min(e * c.dropout, MOST_DROPOUT), "late": c.late if e > 0 else 0}
        return c.model_copy(update=noise | rest)
