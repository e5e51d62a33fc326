"""Provide POp-GS ([popgs]): one policy for each criterion of optimal design, without a travel term."""

from activestructure_gym.policies.popgs.policy import CovTrace as CovTrace
from activestructure_gym.policies.popgs.policy import CovTraceBlock as CovTraceBlock
from activestructure_gym.policies.popgs.policy import CovTraceBlockCov as CovTraceBlockCov
from activestructure_gym.policies.popgs.policy import CovTraceCov as CovTraceCov
from activestructure_gym.policies.popgs.policy import InfoTrace as InfoTrace
from activestructure_gym.policies.popgs.policy import InfoTraceCov as InfoTraceCov
from activestructure_gym.policies.popgs.policy import LogDet as LogDet
from activestructure_gym.policies.popgs.policy import LogDetBlock as LogDetBlock
from activestructure_gym.policies.popgs.policy import LogDetBlockCov as LogDetBlockCov
from activestructure_gym.policies.popgs.policy import LogDetCov as LogDetCov
from activestructure_gym.policies.popgs.policy import MinEig as MinEig
from activestructure_gym.policies.popgs.policy import MinEigCov as MinEigCov
