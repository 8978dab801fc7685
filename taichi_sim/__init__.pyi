"""What type checkers see of taichi_sim/__init__.py: the public names."""

from rl.adapters.batched import BatchedEnv as BatchedEnv
from rl.adapters.marl import batched_env as batched_env
from rl.adapters.marl import parallel_env as parallel_env
from taichi_sim.air import Wind as Wind
from taichi_sim.bench import Bench as Bench
from taichi_sim.bench import calm_sea as calm_sea
from taichi_sim.config import (
    AirConfig as AirConfig,
)
from taichi_sim.config import (
    ConfigError as ConfigError,
)
from taichi_sim.config import (
    CurrentConfig as CurrentConfig,
)
from taichi_sim.config import (
    Finite as Finite,
)
from taichi_sim.config import (
    Fraction as Fraction,
)
from taichi_sim.config import (
    GustConfig as GustConfig,
)
from taichi_sim.config import (
    NonNegative as NonNegative,
)
from taichi_sim.config import (
    Positive as Positive,
)
from taichi_sim.config import (
    Range as Range,
)
from taichi_sim.config import (
    SeaConfig as SeaConfig,
)
from taichi_sim.config import (
    Strict as Strict,
)
from taichi_sim.config import (
    SwellConfig as SwellConfig,
)
from taichi_sim.config import (
    TeamConfig as TeamConfig,
)
from taichi_sim.config import (
    WorldConfig as WorldConfig,
)
from taichi_sim.config.io import load_world as load_world
from taichi_sim.fleet import Fleet as Fleet
from taichi_sim.kernels.packs import (
    AroundPack as AroundPack,
)
from taichi_sim.kernels.packs import (
    Build as Build,
)
from taichi_sim.kernels.packs import (
    FleetPack as FleetPack,
)
from taichi_sim.kernels.packs import (
    load_at as load_at,
)
from taichi_sim.kernels.packs import (
    numbers_at as numbers_at,
)
from taichi_sim.kernels.runtime import init as init
from taichi_sim.recording import Episode as Episode
from taichi_sim.recording import Recorder as Recorder
from taichi_sim.recording import write_recording as write_recording
from taichi_sim.replay import replay as replay
from taichi_sim.script import Script as Script
from taichi_sim.sea import Sea as Sea
from taichi_sim.sea.current import Current as Current
from taichi_sim.surroundings import Surroundings as Surroundings
from taichi_sim.uav.aircraft import Aircraft as Aircraft
from taichi_sim.usv.vessel import Vessel as Vessel
from taichi_sim.vehicle import Limits as Limits
from taichi_sim.vehicle import Vehicle as Vehicle
from taichi_sim.vehicles import load_vehicle as load_vehicle
from taichi_sim.vehicles import shipped_vehicles as shipped_vehicles
from taichi_sim.world import ActionError as ActionError
from taichi_sim.world import World as World

__version__: str
__all__: list[str]
