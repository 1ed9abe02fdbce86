"""PPO in one file, in the style of CleanRL, on the native vector environment; needs torch."""

import gymnasium
import torch
from gymnasium.wrappers.vector import NormalizeObservation, NormalizeReward, RecordEpisodeStatistics
from torch import nn
from torch.distributions import Normal

NUM_ENVS, STEPS, EPOCHS = 8, 6, 10  # an episode is six steps
UPDATES = 4  # a short demonstration; learning takes about a hundred
GAMMA, LAMBDA, CLIP = 0.5, 0.95, 0.2

torch.manual_seed(0)
envs = gymnasium.make_vec("caterpillar_env:CaterpillarSMA-v0", num_envs=NUM_ENVS)
envs = NormalizeReward(NormalizeObservation(RecordEpisodeStatistics(envs)), gamma=GAMMA)
inputs, outputs = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
actor = nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, outputs))
critic = nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 1), nn.Flatten(0))
log_std = nn.Parameter(torch.full((outputs,), -1.2))
with torch.no_grad():
    actor[-1].weight.mul_(0.01)
    actor[-1].bias.copy_(torch.tensor([-0.2, 0.2]).repeat(outputs // 2))  # on for 20 % of the time
adam = torch.optim.Adam([*actor.parameters(), *critic.parameters(), log_std], lr=1e-3)

state = torch.as_tensor(envs.reset(seed=0)[0])
fresh = torch.zeros(NUM_ENVS, dtype=torch.bool)  # rows that are reset in this step
for update in range(UPDATES):
    steps, returns = [], []
    for _ in range(STEPS):
        with torch.no_grad():
            policy = Normal(actor(state), log_std.exp())
            action = policy.sample()
            observation, reward, terminated, truncated, info = envs.step(action.clamp(-1, 1).numpy())
            following = torch.as_tensor(observation)
            future = critic(following) * ~torch.as_tensor(terminated)  # a truncated episode would go on
            error = torch.as_tensor(reward) + GAMMA * future - critic(state)
        done = torch.as_tensor(terminated | truncated)
        steps.append((state, action, policy.log_prob(action).sum(1), error, done, ~fresh))
        returns += list(info["episode"]["r"][info["_episode"]]) if "episode" in info else []
        state, fresh = following, done
    advantage, advantages = torch.zeros(NUM_ENVS), []
    for *_, error, done, _ in reversed(steps):
        advantage = error + GAMMA * LAMBDA * ~done * advantage
        advantages.insert(0, advantage)
    used = torch.cat([step[5] for step in steps])
    states, actions, log_probs = (torch.cat([step[i] for step in steps])[used] for i in range(3))
    advantage = torch.cat(advantages)[used].float()
    target = advantage + critic(states).detach()
    for _ in range(EPOCHS):
        ratio = (Normal(actor(states), log_std.exp()).log_prob(actions).sum(1) - log_probs).exp()
        clipped = ratio.clamp(1 - CLIP, 1 + CLIP)
        objective = torch.minimum(ratio * advantage, clipped * advantage).mean()
        loss = (critic(states) - target).square().mean() - objective
        adam.zero_grad()
        loss.backward()
        adam.step()
    mean = sum(returns) / max(len(returns), 1)
    print(f"update {update}: mean return {mean:5.2f} over {len(returns)} episodes")
