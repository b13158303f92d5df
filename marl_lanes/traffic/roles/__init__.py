"""The roles that can learn, changer and follower: observation, action and reward."""
